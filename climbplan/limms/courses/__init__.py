"""Which actions bring the boxes to their goals, cheapest first."""
