"""Tests of linear models and observers."""
