"""Pilot console: a page in a browser, and its server."""
