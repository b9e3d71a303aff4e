"""`climbplan bench` of climbs: posture, force, plan, coupled, growth, refusals."""
