"""Language models: the client, the embedded server, the sentence embedding."""
