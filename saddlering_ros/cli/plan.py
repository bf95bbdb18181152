"""`saddlering plan`: what given tests could find, before they are made."""

import argparse
import sys

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Bar, Command, option, show_table, tell_json, Within

COMMANDS = (Command(
    'plan', 'compute what given tests could find, before they are made',
    'Compute what tests could find before they are made: the smallest size of each cause, its '
    'look-alikes, the accuracy of K, n and D, and the best further test. Without --test, the four '
    'tests that find most on this rig.', (
        option('--test', 'a test, such as static:50; kinds: static, dynamic, fast, slow, cycles; '
               'may be given several times', action='append', default=[],
               metavar='KIND:ELEVATION'),
        arguments.RIG, arguments.TRUST,
        option('--params', 'parameter file of the ring (default: the true-to-scale values)',
               type=arguments.file_read),
        option('--noise', 'standard deviation of a reading of a probe [um] (default 0.3)',
               type=Within(float, 1e-3, 100.0, ' micrometres'), default=0.3, metavar='UM'),
        arguments.json_option('write the plan as JSON; - for stdout')), (
        ('saddlering plan --test static:50 --test dynamic:50',
         'what a static and a dynamic test could find, and the test to add'),)),)


def run(args: argparse.Namespace) -> int:
    """Compute and print, write or emit the plan."""
    from saddlering_ros import load_rig
    from saddlering_ros.diagnosis.plan import ALL_TESTS, plan_tests, PlanError, planned_test
    from saddlering_ros.quantities import percent, quantity
    from saddlering_ros.rig import PARAMETER_UNITS, TRUE_TO_SCALE

    tests = [planned_test(text) for text in args.test]
    if len(set(tests)) < len(tests):
        raise PlanError('--test is given twice for the same test: give each test once')
    contact = TRUE_TO_SCALE if args.params is None else arguments.read_model(args)[1].contact
    if not tests:
        print(f'saddlering plan: without --test, four of {len(ALL_TESTS)} tests are chosen one by '
              'one: half a minute', file=sys.stderr)
    with Bar() as bar:
        plan = plan_tests(load_rig(args.rig), tests, contact, noise=1e-6 * args.noise,
                          on_progress=bar.tell)
    if tell_json(args, plan.to_json()):
        return 0
    console = arguments.stdout_console()
    console.print(f'tests: {", ".join(test.name for test in plan.tests)}')
    titles = {cause.effect: cause.title for cause in plan.causes}
    show_table(('cause', 'smallest size found', 'cannot be told from'), [
        (cause.title, 'not shown' if not cause.is_testable else
         percent(cause.limit, 3) if cause.unit == '1' else quantity(cause.limit, cause.unit),
         ', '.join(titles[name] for name in cause.group[1:])) for cause in plan.causes], texts=3)
    values = ', '.join(
        f'{name} {quantity(getattr(plan.contact, name), PARAMETER_UNITS[name], std)}'
        for name, std in plan.accuracy.items() if name not in plan.undetermined)
    console.print(f'contact law: {values or "not determined"}')
    for reason in plan.undetermined.values():
        console.print(f'  {reason}')
    if plan.further is not None:
        console.print(f'best further test: {plan.further.name} (limits lower by a factor of '
                      f'{10.0 ** plan.further_gain:.2f} in the geometric mean)')
    return 0
