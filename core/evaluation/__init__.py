"""How well a map answers, by the paper's protocol and the field's."""
