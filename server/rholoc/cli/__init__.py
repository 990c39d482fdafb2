"""The ``rholoc`` command. Commands read files, call the library and print; they hold no numerics."""

from rholoc.cli.app import app, main

__all__ = ["app", "main"]
