"""Examples of every command, as its help shows them; test/docs runs each that is not marked."""

from __future__ import annotations

EXAMPLES: dict[str, tuple[tuple[str, str], ...]] = {
    'campaign': (
        ('saddlering campaign bags --out campaign --plan', 'the bags, and the sessions that '
         'they form'),
        ('saddlering campaign bags --out campaign', 'a verdict for each; again: continue'),
        ('saddlering campaign status campaign', 'its progress'),
    ),
    'check-driver': (
        ('saddlering check-driver', 'faults of the driver; move the load meanwhile'),
        ('saddlering check-driver --rig rig.yaml --elevation 30 --rate 1000 --seconds 20',
         'for your own rig, with the required rate of every channel'),
    ),
    'completion': (
        ('eval "$(saddlering completion bash)"', 'in this shell; add it to ~/.bashrc to keep it'),
    ),
    'demo': (
        ('saddlering demo --out out', 'all steps; then open out/report.html'),
    ),
    'diagnose': (
        ('saddlering diagnose bags/static_50 bags/dynamic_50 --hold-out bags/static_70 '
         '--out extended.yaml --report report.html',
         'name the missing cause, with a held-out run; write a report and parameters'),
    ),
    'displacement': (
        ('saddlering displacement bags/static_50', 'the motion of the ring, in a few lines'),
        ('saddlering displacement bags/static_50 --out ring.csv', 'every sample as a table'),
    ),
    'generate': (
        ('saddlering generate made/friction --test static --elevation 50 '
         '--effect radial_friction=5000', 'a static test with a hidden friction of 5 kN'),
        ('saddlering generate --list-effects', 'the effects that can be hidden'),
    ),
    'identify': (
        ('saddlering identify bags/static_50 bags/dynamic_50 --out params.yaml',
         'contact parameters with their uncertainty'),
        ('saddlering identify bags/static_50 bags/dynamic_50 --method paper --seed 3',
         'by the published two-step swarm'),
    ),
    'import': (
        ('saddlering import docs/data/static_30.csv --draft',
         'the content of a file, and a draft of its map'),
        ('saddlering import docs/data/static_30.csv --map docs/data/map_static_30.yaml '
         '--rig docs/data/rig.yaml --out measured/static_30 --preview measured/static_30.png',
         'the file as a bag, with a figure'),
    ),
    'info': (
        ('saddlering info bags/static_50', 'the content of a bag and its faults'),
        ('saddlering info bags/static_50 bags/dynamic_50 --json -', 'the same for a program'),
    ),
    'live': (
        ('saddlering live', 'then, in another terminal: saddlering replay bags/dynamic_50'),
        ('saddlering live --host 0.0.0.0', 'for other machines; the printed address contains a '
                                           'token'),
    ),
    'record': (
        ('saddlering record test_17 --test static --elevation 50',
         'a test on the rig that can be identified and diagnosed'),
    ),
    'replay': (
        ('saddlering replay bags/dynamic_50 --params params.yaml', 'to live nodes, in real time'),
        ('saddlering replay bags/dynamic_50 --params params.yaml --rate 0 --record replayed',
         'as fast as possible, with all results in a new bag'),
    ),
    'report': (
        ('saddlering report bags/static_70 --params params.yaml --out parameters.html',
         'a report on the prediction of another test'),
    ),
    'residual': (
        ('saddlering residual bags/static_70 --params params.yaml --out residual.parquet',
         'measured minus simulated, sample by sample'),
    ),
    'rig': (
        ('saddlering rig --draft my_rig.yaml --set axial_rows.rollers=48 '
         '--set full_scale_load=98066.5', 'a rig file to complete, and a drawing of this ring'),
        ('saddlering rig --check bags/static_50', 'contradictions between a bag and the rig file'),
    ),
    'simulate': (
        ('saddlering simulate bags/static_70 --params params.yaml --out simulated.csv',
         'the motion of the model under the load of a bag'),
    ),
    'watch': (
        ('saddlering watch bags/dynamic_70 --params params.yaml',
         'whether, when and in which channel a test raises the alarm'),
    ),
    'validate': (
        ('saddlering validate bags/static_70 bags/dynamic_70 --params params.yaml '
         '--plots pictures',
         'figures of merit for each channel, and a figure of each run'),
    ),
}

UNTRIED = {
    'campaign': 'test/campaign tests it',
    'check-driver': 'test/nodes/test_check_driver.py runs it beside the example driver',
    'completion': 'changes the shell it is typed in', 'demo': 'test/cli/test_demo.py runs it',
    'live': 'serves until it is ended', 'record': 'records until it is ended',
    'replay': 'test/cli/test_numbers_out.py replays a bag and records it',
}
"""Commands whose examples are not typed by a test, and the reason."""

START = (
    ('saddlering demo', 'all steps, on the shipped bags'),
    ('saddlering info bags/static_50', 'the content of a bag and its faults'),
    ('saddlering identify bags/static_50 bags/dynamic_50 --out params.yaml',
     'find the contact parameters'),
    ('saddlering diagnose bags/static_50 bags/dynamic_50 --report report.html',
     'name the cause that the simulation lacks'),
    ('saddlering live', 'watch a test in the browser'),
)
"""Examples in the help of saddlering itself."""

EXAMPLES['saddlering'] = START
