"""Forces of climbing robots with grippers (chapter 3.4)."""
