"""Models by other photogrammetry programs: pictures with the poses that these found."""
