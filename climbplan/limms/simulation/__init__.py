"""Plans of modules replayed in MuJoCo."""
