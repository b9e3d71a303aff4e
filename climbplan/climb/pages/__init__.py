"""Pages and figures of climbs, transitions and missions."""
