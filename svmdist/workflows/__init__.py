"""What svmdist does, one public function a workflow, usable without the command line."""
