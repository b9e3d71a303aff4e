"""Plans replayed in a physics simulation, which judges them: slips, falls, torques, sag."""
