"""Methods for any stated problem: candidates, pinned programs, conflicts, the exact check."""
