"""First stage of the planner: posture sequences (chapter 5.1.3).

Chapter numbers are those of X. Lin (UCLA 2022).
"""
