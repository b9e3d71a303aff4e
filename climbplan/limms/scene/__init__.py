"""The scene: free space, anchors, boxes and modules as arrays, and bounds on plans."""
