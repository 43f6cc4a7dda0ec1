"""What the laboratory shows: registry, control charts, data sheets."""
