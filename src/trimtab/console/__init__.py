"""Pilot console: a page in a browser, and the server of the page."""
