"""What happens between two control ticks: clock, latency, perception server, faults, miscalibration."""
