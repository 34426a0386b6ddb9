"""Controllers: the tick, its references and its supervisor."""
