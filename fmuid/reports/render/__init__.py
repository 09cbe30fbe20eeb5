"""Renderers of documents: terminal, page, notebook, JSON, print."""
