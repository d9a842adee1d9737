"""Campaigns: up to millions of flights of law and plant at a fixed step, compiled, on all cores."""
