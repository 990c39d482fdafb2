"""Analysis of a walk: pauses, problems, figures, advice."""
