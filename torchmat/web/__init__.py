"""A material in a browser: its shaders, the page that shows it, and what that page is put together from."""
