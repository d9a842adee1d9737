"""`guidance check`: all that a flight rests on, looked at before it, with what to do where it fails.

It moves nothing. To add a check: one function from what was seen to findings, one row in `checks.py`.
"""
