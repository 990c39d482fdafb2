"""Sources of a recording's pictures: a video, a folder of images, memory."""
