"""What the robot knows of itself by its own sensors: base, contacts, forces under the feet."""
