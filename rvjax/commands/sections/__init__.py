"""Tables, texts and plots that several commands share."""
