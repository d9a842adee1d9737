"""What a log shows, for people: figures, one self-contained page, and images. Needs the extra `report`."""
