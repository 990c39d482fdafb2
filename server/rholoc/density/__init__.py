"""Equation (3): tensor, ray, presence. Pure numerics."""
