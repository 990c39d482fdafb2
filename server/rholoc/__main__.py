"""``python -m rholoc`` is the ``rholoc`` command."""

from rholoc.cli import main

main()
