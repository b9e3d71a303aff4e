"""Second stage of the planner: contact forces by convex programs (chapter 5.1.4).

Chapter numbers are those of X. Lin (UCLA 2022).
"""
