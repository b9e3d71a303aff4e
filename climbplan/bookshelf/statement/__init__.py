"""The bookshelf as a mixed-integer bilinear program."""
