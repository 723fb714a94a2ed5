"""Tests of condensing, solvers and limits."""
