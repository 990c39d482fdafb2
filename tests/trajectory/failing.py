"""A function that fails in a child process, which imports little else."""


def fail(text: str, _: object) -> None:
    """Raise RuntimeError."""
    raise RuntimeError(text)
