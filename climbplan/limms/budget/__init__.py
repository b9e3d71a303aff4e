"""The budget of planning: programs solved, time used, and notes on failures."""
