"""Reports of plans: figures, a JSON summary, and one self-contained HTML page."""
