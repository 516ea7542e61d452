"""Missions to look at: a page that plays them in a browser, and films."""
