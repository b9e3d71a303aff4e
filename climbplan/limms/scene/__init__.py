"""The scene: free space, anchors, boxes and modules in numbers, and bounds on plans."""
