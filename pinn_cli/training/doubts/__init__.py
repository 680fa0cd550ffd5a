"""What a model may lack: parameters that it does not have, and what the record says of them."""
