"""Pictures and plots, in one style. The only package that imports matplotlib, which takes a third of a second to load.

Each module draws one thing; nothing is imported with the package.
"""
