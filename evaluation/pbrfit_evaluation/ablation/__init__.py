"""The ablation: what each prior is worth, where segments are right, wrong or missing."""
