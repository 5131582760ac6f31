"""Compute the claims of four papers, and compare them with the papers. The tolerances were fixed beforehand
(docs/gallery).
"""
