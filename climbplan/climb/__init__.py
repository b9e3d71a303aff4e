"""The decoupled climbing planner (chapter 5.1): postures first, then forces."""
