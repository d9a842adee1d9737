"""What each class of vehicles must reach: tasks flown by the whole service against the built-in vehicle."""
