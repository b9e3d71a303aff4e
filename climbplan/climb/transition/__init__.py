"""Transition: from standing on the ground to bracing between walls (chapter 5.3)."""
