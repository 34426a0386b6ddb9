"""A Unitree G1 over DDS: its messages byte by byte, its check sum, its joints by name, its remote."""
