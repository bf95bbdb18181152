"""fleet.json and report.html of a store."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import json

from saddlering_ros.campaign.errors import CampaignError
from saddlering_ros.campaign.store import Store
from saddlering_ros.campaign.tables import p_value_of, results_of
from saddlering_ros.campaign.task import SessionTask
from saddlering_ros.files import write_text
from saddlering_ros.fleet import figures_of, fleet_document, judge_fleet
from saddlering_ros.fleet.judgement import Fleet


def write_fleet(store: Store, tasks: Sequence[SessionTask], limits: Mapping[str, float]) -> Fleet:
    """Judge the fleet of the sessions that have a verdict; write fleet.json and report.html."""
    from saddlering_ros.fleet.page import fleet_page

    figures, failures = [], []
    for task, result in results_of(store, tasks):
        if result['status'] == 'failed':
            failures.append((task.name, str(result['reason'])))
            continue
        figures.append(figures_of(task.as_dict(), result, p_value_of(result['verdict'])))
    fleet = judge_fleet(figures, limits)
    document = fleet_document(fleet)
    document['failures'] = [{'session': name, 'reason': reason} for name, reason in failures]
    write_text(store.folder / 'fleet.json', json.dumps(document, indent=1) + '\n', CampaignError)
    write_text(store.folder / 'report.html', fleet_page(fleet, failures), CampaignError)
    return fleet
