"""Build and install saddlering_ros, by colcon or by pip alike."""

from pathlib import Path
import sys

from setuptools import find_packages, setup

PACKAGE = 'saddlering_ros'
HERE = Path(__file__).resolve().parent

sys.path.insert(0, str(HERE))
from saddlering_ros.ros.names import NODES  # noqa: E402  (imports nothing but the standard library)


def shared_files(folder):
    """Return data_files entries that install `folder`, subfolders included, under share/."""
    files = {}
    for path in sorted((HERE / folder).rglob('*')):
        if path.is_file() and '__pycache__' not in path.parts:
            source = path.relative_to(HERE)
            files.setdefault(f'share/{PACKAGE}/{source.parent}', []).append(str(source))
    return list(files.items())


def required(name):
    """Return the lines of one requirements file."""
    return (HERE / 'requirements' / f'{name}.in').read_text().split()


setup(
    name=PACKAGE,
    version='0.1.0',
    description='Test rig, simulator and diagnosis of a saddle ring, on ROS 2.',
    long_description=(HERE / 'README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    classifiers=[
        'Development Status :: 4 - Beta',
        'Environment :: Console',
        'Intended Audience :: Science/Research',
        'Operating System :: POSIX :: Linux',
        'Programming Language :: Python :: 3',
        'Programming Language :: Python :: 3.10',
        'Programming Language :: Python :: 3.11',
        'Programming Language :: Python :: 3.12',
        'Programming Language :: Python :: 3.13',
        'Topic :: Scientific/Engineering',
    ],
    maintainer='Seed 74823868 maintainers',
    maintainer_email='maintainers@users.noreply.h-seed-74823868.example',
    license='Apache-2.0',
    python_requires='>=3.10',
    packages=find_packages(include=[PACKAGE, f'{PACKAGE}.*']),
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        *shared_files('launch'),
        *shared_files('config'),
        *shared_files('bags'),
    ],
    package_data={PACKAGE: ['pages/*.css', 'pages/*.js', 'live/page/*']},
    include_package_data=True,
    zip_safe=False,
    install_requires=['setuptools', *required('run')],
    extras_require={
        # rclpy and the messages, where no ROS 2 Jazzy is installed. Never a plain requirement:
        # on a Jazzy of its own, pip would put a second rclpy over the system's.
        'ros': required('ros'),
        'test': required('test'),
        # `saddlering campaign` on a Dask cluster.
        'cluster': required('cluster'),
    },
    entry_points={
        'console_scripts': [
            'saddlering = saddlering_ros.cli.main:main',
            *(f'{node.name} = {node.module}:main' for node in NODES),
        ],
    },
)
