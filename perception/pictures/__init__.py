"""Pictures of one's own camera: read, undistorted, turned into depth, written."""
