"""Flying against the clock: messages, the aircraft's process, the controller, its laws and its log."""
