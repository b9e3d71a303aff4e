"""One module: its chain of joints, what it touches, and what it weighs."""
