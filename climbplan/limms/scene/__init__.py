"""Free space, anchors, boxes and modules in numbers, and bounds that no plan escapes."""
