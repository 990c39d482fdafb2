"""The paper's own programs: Table 4 from recordings (Figure 6), maps from it (Figure 8), its localizer (Figure 9)."""
