"""Methods for any stated problem: candidates, fixed integers, conflicts, the exact check."""
