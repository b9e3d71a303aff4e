"""From postures to a motion with forces that passes the exact checks."""
