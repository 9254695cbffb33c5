"""Entry point of the `laploop` command."""


def main() -> None:
    """Run the command line."""
