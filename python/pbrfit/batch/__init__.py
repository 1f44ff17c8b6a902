"""Many tasks at once: in this process, in several, or on a cluster (docs/batch.md).

`executors` and `cluster` say where tasks run, `driver` hands them over and sees to those whose
process died. `scenes` is the task of `pbrfit decompose`: one scene folder to one result folder;
`unchanged` whether that was done already, `prediction` how much memory it will take, `place` where
unfinished results lie. `pbrfit evaluate` has tasks of its own.
"""
