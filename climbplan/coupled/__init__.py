"""The coupled planner of chapter 5.2: toe positions and contact forces chosen together."""
