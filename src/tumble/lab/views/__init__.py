"""What the laboratory shows: registry and data sheets."""
