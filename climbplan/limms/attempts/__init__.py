"""What planning has tried, what programs answered, and how long it may go on."""
