"""Second stage of the planner: contact forces by convex programs (chapter 5.1.4)."""
