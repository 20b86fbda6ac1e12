"""What make and the tests run besides the product; nothing here is shipped."""
