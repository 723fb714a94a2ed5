"""Figures: which lines, charts as Vega-Lite, and their pictures."""
