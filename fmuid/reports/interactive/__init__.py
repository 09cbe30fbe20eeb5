"""Figures for browser, report and notebook: data in, a Bokeh model out."""
