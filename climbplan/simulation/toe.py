"""The toe that is simulated: a small sphere about the planned toe point."""

# Contact forces act on a toe's surface, the planner's at a point. A radius of 2 mm bends SiLVIA's
# limbs by as much as a sag of 0.15 mm, which is in proportion to it.
TOE_RADIUS = 0.0005  # [m]
