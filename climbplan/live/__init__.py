"""The live page of `climbplan serve`: specs in an editor, planned, replayed and compared."""
