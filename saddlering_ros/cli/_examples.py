"""Examples of every command, as its help shows them; test/docs runs each that is not marked."""

from __future__ import annotations

EXAMPLES: dict[str, tuple[tuple[str, str], ...]] = {
    'campaign': (
        ('saddlering campaign bags --out campaign --plan', 'which bags are there, and which '
         'sessions they make'),
        ('saddlering campaign bags --out campaign', 'a verdict for each; again: what is missing'),
        ('saddlering campaign status campaign', 'how far it is'),
    ),
    'check-driver': (
        ('saddlering check-driver', 'is the driver of the rig sound? move the load meanwhile'),
        ('saddlering check-driver --rig rig.yaml --elevation 30 --rate 1000 --seconds 20',
         'of your own rig, with the rate that every channel must have'),
    ),
    'completion': (
        ('eval "$(saddlering completion bash)"', 'in this shell; put it into ~/.bashrc for good'),
    ),
    'demo': (
        ('saddlering demo --out out', 'the whole story; then open out/report.html'),
    ),
    'diagnose': (
        ('saddlering diagnose bags/static_50 bags/dynamic_50 --hold-out bags/static_70 '
         '--out extended.yaml --report report.html',
         'name what is missing, judged on a run held out; a page and parameters of it'),
    ),
    'displacement': (
        ('saddlering displacement bags/static_50', 'what the ring did, in a few lines'),
        ('saddlering displacement bags/static_50 --out ring.csv', 'every sample as a table'),
    ),
    'generate': (
        ('saddlering generate made/friction --test static --elevation 50 '
         '--effect radial_friction=5000', 'a static test with 5 kN of friction hidden in it'),
        ('saddlering generate --list-effects', 'what can be hidden'),
    ),
    'identify': (
        ('saddlering identify bags/static_50 bags/dynamic_50 --out params.yaml',
         'contact parameters with their uncertainty'),
        ('saddlering identify bags/static_50 bags/dynamic_50 --method paper --seed 3',
         'by the published two-step swarm'),
    ),
    'import': (
        ('saddlering import docs/data/static_30.csv --draft',
         'what is in a file, and a first map of it'),
        ('saddlering import docs/data/static_30.csv --map docs/data/map_static_30.yaml '
         '--rig docs/data/rig.yaml --out measured/static_30 --preview measured/static_30.png',
         'the file as a bag, and a picture of it'),
    ),
    'info': (
        ('saddlering info bags/static_50', 'what is in a bag'),
        ('saddlering info bags/static_50 bags/dynamic_50 --json -', 'the same for a program'),
    ),
    'live': (
        ('saddlering live', 'then, in another terminal: saddlering replay bags/dynamic_50'),
        ('saddlering live --host 0.0.0.0', 'for other machines; the address printed has a token'),
    ),
    'record': (
        ('saddlering record test_17 --test static --elevation 50',
         'a test on the rig, ready to be identified from'),
    ),
    'replay': (
        ('saddlering replay bags/dynamic_50 --params params.yaml', 'to live nodes, in real time'),
        ('saddlering replay bags/dynamic_50 --params params.yaml --rate 0 --record replayed',
         'as fast as it goes, results and all into a new bag'),
    ),
    'report': (
        ('saddlering report bags/static_70 --params params.yaml --out parameters.html',
         'a page on how well parameters predict another test'),
    ),
    'residual': (
        ('saddlering residual bags/static_70 --params params.yaml --out residual.parquet',
         'measured less simulated, sample by sample'),
    ),
    'rig': (
        ('saddlering rig --draft my_rig.yaml --set axial_rows.rollers=48 '
         '--set full_scale_load=98066.5', 'a rig file to complete, and a drawing of that ring'),
        ('saddlering rig --check bags/static_50', 'whether a bag fits the rig'),
    ),
    'simulate': (
        ('saddlering simulate bags/static_70 --params params.yaml --out simulated.csv',
         'what the model gives under the load of a bag'),
    ),
    'watch': (
        ('saddlering watch bags/dynamic_70 --params params.yaml',
         'whether a test would have raised the alarm, when, and in which channel'),
    ),
    'validate': (
        ('saddlering validate bags/static_70 bags/dynamic_70 --params params.yaml '
         '--plots pictures',
         'figures of merit, channel by channel, and a picture of each run'),
    ),
}

UNTRIED = {
    'campaign': 'test/campaign tests it',
    'check-driver': 'test/nodes/test_check_driver.py runs it beside the example driver',
    'completion': 'changes the shell it is typed in', 'demo': 'test/cli/test_demo.py runs it',
    'live': 'serves until it is ended', 'record': 'records until it is ended',
    'replay': 'test/cli/test_numbers_out.py replays a bag and records it',
}
"""Commands whose examples no test types as they stand, and why."""

START = (
    ('saddlering demo', 'everything at once, on the shipped bags'),
    ('saddlering info bags/static_50', 'what is in a bag'),
    ('saddlering identify bags/static_50 bags/dynamic_50 --out params.yaml',
     'find the contact parameters'),
    ('saddlering diagnose bags/static_50 bags/dynamic_50 --report report.html',
     'name what the simulation lacks'),
    ('saddlering live', 'watch a test in the browser'),
)
"""What the help of saddlering itself shows."""

EXAMPLES['saddlering'] = START
