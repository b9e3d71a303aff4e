"""The exact checks of walks: nonlinear dynamics, contact, friction, workspace."""
