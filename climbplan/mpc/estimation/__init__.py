"""Where the body is, from an inertial measurement unit, encoders and contacts (chapter 8.2.3)."""
