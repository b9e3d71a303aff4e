"""Branch and bound over binaries, integers and implications, compiled as a whole."""
