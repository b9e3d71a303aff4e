"""The climb planner: methods, remedies, proofs, and studies over spec values."""
