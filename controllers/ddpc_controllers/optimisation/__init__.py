"""Tracking problems: written down in named blocks, condensed, and solved within their limits."""
