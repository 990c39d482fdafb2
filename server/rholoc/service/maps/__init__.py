"""Maps and sites as clients see and change them, and the jobs that make maps."""
