"""Walking plans: results in memory, plan files, and summaries."""
