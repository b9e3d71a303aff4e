"""Task planning: which actions bring the boxes to their goals, cheapest first."""
