"""Contact planning along a guide path of the body: footholds one after the other, each checked."""
