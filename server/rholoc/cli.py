"""The ``rholoc`` command."""


def main() -> None:
    """Run the command."""
