"""``report.html``: what is in a folder of results, on one page."""
