// Prints whether the ring is within its limits; a late message or a dead publisher counts as false.
//
// Beside the Python examples for programs in C++. Built by colcon on a ROS 2 that has rclcpp:
//   colcon build --base-paths examples/interlock_cpp && ros2 run interlock_cpp limits_listener

#include <chrono>
#include <memory>

#include "rclcpp/rclcpp.hpp"
#include "saddlering_interfaces/msg/ring_expected.hpp"
#include "std_msgs/msg/bool.hpp"

using namespace std::chrono_literals;

class LimitsListener : public rclcpp::Node
{
public:
  LimitsListener()
  : Node("limits_listener")
  {
    rclcpp::SubscriptionOptions options;
    options.event_callbacks.deadline_callback =
      [this](rclcpp::QOSDeadlineRequestedInfo &) {set(false, "ring/within_limits is late");};
    options.event_callbacks.liveliness_callback =
      [this](rclcpp::QOSLivelinessChangedInfo & event) {
        if (event.alive_count == 0) {
          set(false, "ring_alarm is not alive");
        }
      };
    const auto qos = rclcpp::QoS(1).reliable().transient_local().deadline(300ms)
      .liveliness(rclcpp::LivelinessPolicy::Automatic).liveliness_lease_duration(1s);
    limits_ = create_subscription<std_msgs::msg::Bool>(
      "ring/within_limits", qos,
      [this](const std_msgs::msg::Bool & message) {set(message.data, "as ring_alarm reports");},
      options);
    expected_ = create_subscription<saddlering_interfaces::msg::RingExpected>(
      "ring/expected", rclcpp::SensorDataQoS(),
      [this](const saddlering_interfaces::msg::RingExpected & message) {
        RCLCPP_INFO_THROTTLE(
          get_logger(), *get_clock(), 1000, "expected delta_x %.2f um at %.1f kN, validity %u",
          1e6 * message.delta_x, 1e-3 * message.load, message.validity);
      });
  }

private:
  void set(bool is_within, const char * reason)
  {
    if (is_within != is_within_) {
      RCLCPP_INFO(get_logger(), "%s: %s", is_within ? "within limits" : "STOP", reason);
    }
    is_within_ = is_within;
  }

  bool is_within_ = false;
  rclcpp::Subscription<std_msgs::msg::Bool>::SharedPtr limits_;
  rclcpp::Subscription<saddlering_interfaces::msg::RingExpected>::SharedPtr expected_;
};

int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  rclcpp::spin(std::make_shared<LimitsListener>());
  rclcpp::shutdown();
  return 0;
}
