"""Tests of data and what is made of them."""
