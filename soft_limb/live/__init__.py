"""A page in the browser that shows a limb while it runs; its server is a process of its own."""
