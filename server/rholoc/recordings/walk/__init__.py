"""How a recording was walked: pauses, problems, figures, advice."""
