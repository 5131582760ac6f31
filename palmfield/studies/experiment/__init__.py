"""Experiments on what is felt: procedures, trials on a board, logs, reports."""
