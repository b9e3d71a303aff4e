"""Room that links, body and swinging toes have, as planning measures it."""
