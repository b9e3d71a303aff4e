"""Robot and terrain as MuJoCo bodies."""
