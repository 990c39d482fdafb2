"""Where the pictures of a recording come from: a video, a folder of images, memory."""
