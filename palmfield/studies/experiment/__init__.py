"""Experiments on perception: procedures, trials on a board, logs, reports."""
