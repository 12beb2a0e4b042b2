"""What the methods of particles share: their state, emitters and sinks."""
