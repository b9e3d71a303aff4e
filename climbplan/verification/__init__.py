"""What all checks of plans share: limits, outcomes, badges, specs to hold plans against."""
