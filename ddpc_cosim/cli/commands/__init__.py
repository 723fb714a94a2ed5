"""The commands, each in a file of its name: its options, and what it does.

``--help`` and the shell's completion import these files, so that they import what takes a while in functions.
"""
