"""What the studies make of their rows: charts, tables and sentences, an analysis a module."""
