"""First stage of the planner: posture sequences (chapter 5.1.3)."""
