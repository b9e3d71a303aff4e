"""`limms`: both methods on the same scenes, published figures beside ours."""
