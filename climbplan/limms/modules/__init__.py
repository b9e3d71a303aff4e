"""One module: its chain of joints, what it touches, and how it moves on its own."""
