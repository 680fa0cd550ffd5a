"""What a run leaves behind: tables, labelled time histories, figures; and what the paper published."""
