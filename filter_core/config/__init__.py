"""Keys of the configuration and what is made of them."""
