"""What is kept of frames after their answers: who asked, what was refused, and features for maps to learn from."""
