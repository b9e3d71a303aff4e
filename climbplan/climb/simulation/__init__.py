"""Climbs and transitions played in MuJoCo and by statics, as planned and in uncertain worlds."""
